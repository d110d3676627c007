# SPDX-License-Identifier: Apache-2.0
"""Renders the manifests of deploy/kubernetes, also with the kubectl of Debian 12. For kubernetes_test.py and sentinel_group_test.py."""

import json
import pathlib
import shutil
import subprocess
import sys

import yaml

DEPLOY = pathlib.Path(__file__).resolve().parent.parent / "deploy"


def copy(directory):
    """Copies the manifests and the files that they use, and returns the copy of deploy/kubernetes."""
    for name in ("kubernetes", "haproxy", "redis"):
        shutil.copytree(DEPLOY / name, directory / name)
    return directory / "kubernetes"


def write_for_old_kustomize(directory):
    """Renames fields for Debian 12's kubectl, whose kustomize of 2018 has other names for them."""
    for path in directory.rglob("kustomization.yaml"):
        content = yaml.safe_load(path.read_text())
        resources = content.pop("resources", [])
        content["bases"] = [name for name in resources if (path.parent / name).is_dir()]
        content["resources"] = [name for name in resources if not (path.parent / name).is_dir()]
        patches = content.pop("patches", [])
        content["patchesStrategicMerge"] = [patch["path"] for patch in patches if "target" not in patch]
        content["patchesJson6902"] = [patch for patch in patches if "target" in patch]
        path.write_text(yaml.safe_dump({name: value for name, value in content.items() if value}))


class Renderer:
    """`kubectl kustomize` in a copy of deploy/kubernetes."""

    def __init__(self, directory, kubectl="kubectl"):
        self.directory, self.kubectl = directory, kubectl
        version = subprocess.run([kubectl, "version", "--client", "--output=json"], capture_output=True, text=True, check=True)
        if "kustomizeVersion" not in json.loads(version.stdout):
            write_for_old_kustomize(directory)

    def render(self, folder):
        """Returns the objects by kind and name. Ends the program if one is there twice or outside of the namespace."""
        run = subprocess.run([self.kubectl, "kustomize", self.directory / folder], capture_output=True, text=True)
        if run.returncode != 0 or "deprecated" in run.stderr:
            sys.exit(f"kubectl kustomize {folder}: {run.stderr}")
        objects = {}
        for document in yaml.safe_load_all(run.stdout):
            name = document["kind"], document["metadata"]["name"]
            if name in objects:
                sys.exit(f"{folder} has {name} twice")
            if document["kind"] != "Namespace" and document["metadata"].get("namespace") != "evpose":
                sys.exit(f"{folder}: {name} is in no namespace")
            objects[name] = document
        return objects
