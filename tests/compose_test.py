#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Checks that the compose files are consistent, without a container engine. tests/container/run.sh runs two of them, and
tests/sentinel_group_test.py runs the processes of compose.sentinel.yaml."""

import pathlib
import re

import yaml

from checks import check

ROOT = pathlib.Path(__file__).resolve().parent.parent


def services(name):
    return yaml.safe_load((ROOT / "deploy" / name).read_text())["services"]


def options(command):
    """Returns the values of the options by name; None for an option without a value."""
    found = {}
    for word, following in zip(command, command[1:] + ["--"]):
        if word.startswith("--"):
            found[word] = None if following.startswith("--") else following
    return found


def check_memory(name):
    """Checks that a server's limit of memory has room for its sessions, its preparations of models and the rest."""
    # The defaults: --slow-threads times --model-memory; --max-model-store-bytes and --max-transport-bytes, and the process itself.
    other_bytes = (2 << 30) + (1 << 30) + 200_000_000
    for service, document in services(name).items():
        if not service.startswith("server"):
            continue
        sessions_bytes = int(options(document["command"])["--max-session-memory"])
        limit_bytes = int(document["mem_limit"].removesuffix("g")) << 30
        check(sessions_bytes + other_bytes <= limit_bytes, service, "of", name, "has too little memory")


def check_tls(below, on_top):
    """Checks that a command in `on_top`, which replaces that in `below`, repeats all of its options."""
    for name, service in services(on_top).items():
        if not name.startswith("server"):
            continue
        encrypted = options(service["command"])
        for option, value in options(services(below)[name]["command"]).items():
            check(encrypted.get(option, "") == value, name, "of", on_top, "has not", option, value or "", "of", below)


def check_versions():
    """Checks that the default version of the images is that of the project."""
    version = re.search(r"^project\(evpose VERSION ([\d.]+)", (ROOT / "CMakeLists.txt").read_text(), re.M)[1]
    for name in ("Dockerfile", "compose.yaml", "compose.cluster.yaml", "compose.sentinel.yaml"):
        versions = re.findall(r"VERSION(?:=|:-)([^}\s]*)", (ROOT / "deploy" / name).read_text())
        check(versions and set(versions) == {version}, name, "has the version", versions, "and not", version)


def check_published(name, service, document):
    """Checks that a port of the API is published by the proxy only."""
    open_ports = [port for port in document.get("ports", []) if re.search(r":(50051|50443)(/|$)", port)]
    check(not open_ports or service == "haproxy", service, "of", name, "is published without a proxy")


def check_images():
    """Checks that the images that are not built here are named in .env only, and that clients reach HAProxy only."""
    deploy = ROOT / "deploy"
    images = dict(re.findall(r"^(\w+)=(\S+)$", (deploy / ".env").read_text(), re.M))
    for path in (deploy / "Dockerfile", ROOT / "tests/container/others.Dockerfile"):
        text = path.read_text()
        check(f"ARG BASE_IMAGE={images['BASE_IMAGE']}\n" in text, path.name, "has another base image than .env")
        check(set(re.findall(r"^FROM (\S+)", text, re.M)) <= {"${BASE_IMAGE}"}, path.name, "uses other base images")
    for name in ("compose.yaml", "compose.cluster.yaml", "compose.sentinel.yaml"):
        for service, document in services(name).items():
            named = re.fullmatch(r"\$\{(\w+)\}", document["image"])
            check(named and named[1] in images or document["image"].startswith("evpose-"), service, "of", name, document["image"])
            check_published(name, service, document)
    for path in deploy.glob("*.tls.yaml"):
        for service, document in services(path.name).items():
            check_published(path.name, service, document)


def check_environment():
    """Checks that the servers log as in Kubernetes, and that the bound of their load is a variable."""
    pods = (ROOT / "deploy/kubernetes/base/kustomization.yaml").read_text()
    log_format = re.search(r"EVPOSE_LOG_FORMAT=(\w+)", pods)[1]
    for name in ("compose.yaml", "compose.cluster.yaml", "compose.sentinel.yaml"):
        servers = {service: document for service, document in services(name).items() if service.startswith("server")}
        check(servers, name, "has no server")
        for service, document in servers.items():
            environment = document["environment"]
            check(environment["EVPOSE_LOG_FORMAT"] == log_format, service, "of", name, "logs as", environment["EVPOSE_LOG_FORMAT"])
            is_one = service == "server"
            check(is_one or environment["EVPOSE_MAX_LOAD"] == "${EVPOSE_MAX_LOAD:-0}", service, "of", name, "has no bound of its load")


def check_view():
    """Checks that the page of evpose view is published on the loopback address alone, under the port that it listens on, which browsers
    name in the header Host, and only if its profile is chosen."""
    view = services("compose.yaml")["view"]
    check(view["profiles"] == ["view"], "view of compose.yaml starts without its profile")
    check(view["command"][0] == "view", "view of compose.yaml runs", view["command"])
    port = options(view["command"])["--listen"].removeprefix("0.0.0.0:")
    check(view["ports"] == [f"127.0.0.1:{port}:{port}"], "view of compose.yaml publishes", view["ports"])


def check_sentinels():
    """Checks that the tunnels of a server have an address for each node and Sentinel of compose.sentinel.yaml, under the names that these
    announce, and that the memory of a node is twice what it may store."""
    found = services("compose.sentinel.yaml")
    tunnels = (ROOT / "deploy/haproxy/store-sentinel.cfg").read_text()
    # Compose uses the defaults of the variables.
    tunnels = re.sub(r'"\$\{\w+-([\w-]+)\}(\S+)"', r"\1\2", tunnels)
    ways = dict(re.findall(r"bind (\S+)\n  server (?:\S+) (\S+)$", tunnels, re.M))
    for number in ("1", "2", "3"):
        store, server = found["store-" + number], found["server-" + number]
        check(server["network_mode"] == "service:store-" + number, "server", number, "has no tunnels on its loopback interface")
        check(store["networks"]["inside"]["aliases"] == ["server-" + number], "HAProxy does not find server", number)
        names = dict(entry.split(":") for entry in store["extra_hosts"])
        check(ways[names["redis-" + number] + ":6379"] == f"redis-{number}:6379", "another node than", names)
        sentinels = options(server["command"])["--store"].removeprefix("redis+sentinel://").removesuffix("/evpose").split(",")
        check([ways[sentinel] for sentinel in sentinels] == [f"sentinel-{i}:26379" for i in (1, 2, 3)], "no tunnels to", sentinels)
        for kind, word in (("redis", "node"), ("sentinel", "sentinel")):
            name = f"{kind}-{number}"
            check(found[name]["command"] == ["/etc/redis-group/start.sh", word, name, "redis-1"], name, "starts", found[name]["command"])
            check(f"{name}:/data" in found[name]["volumes"], name, "has no volume of its own")
        gigabytes = int(re.search(r"^maxmemory (\d+)gb$", (ROOT / "deploy/redis/node.conf").read_text(), re.M)[1])
        check(int(found["redis-" + number]["mem_limit"].removesuffix("g")) >= 2 * gigabytes, "no room for the rewrite of a file")


def main():
    check_versions()
    check_environment()
    check_images()
    check_view()
    check_memory("compose.yaml")
    check_memory("compose.cluster.yaml")
    check_memory("compose.sentinel.yaml")
    check_sentinels()
    check_tls("compose.yaml", "compose.tls.yaml")
    check_tls("compose.cluster.yaml", "compose.cluster.tls.yaml")
    check_tls("compose.sentinel.yaml", "compose.sentinel.tls.yaml")


main()
