# SPDX-License-Identifier: Apache-2.0
"""The second part of kubernetes_test.sh, which prepares the files for this script."""

import base64
import json
import os
import pathlib
import re
import signal
import subprocess
import sys
import urllib.error
import urllib.request

import yaml

import manifests
from checks import check

SERVER, KUBECTL, WORK = sys.argv[1], sys.argv[2], pathlib.Path(sys.argv[3])
MANIFESTS = WORK / "kubernetes"
RENDERER = manifests.Renderer(MANIFESTS, KUBECTL)
SECRETS = ("secrets/access", "secrets/redis")
OVERLAYS = {"overlays/single": SECRETS[:1], "overlays/cluster": SECRETS, "overlays/sentinel": SECRETS}
# Memory beside that of sessions, by the defaults of the server: --slow-threads times --model-memory; --max-model-store-bytes and
# --max-transport-bytes, and the process itself.
PREPARATION_BYTES = 2 << 30
OTHER_BYTES = (1 << 30) + 200_000_000
# Memory of Redis for a session whose log of poses is full (deploy/sizing.md).
SESSION_BYTES = 3.2e6
# Cores of Redis that a session with 1000 poses per second uses, and its core's share that is used at most (deploy/sizing.md).
SESSION_CORES = 0.0015
MAX_REDIS_CORES = 0.7


def of_kind(objects, kind):
    return [document for (each, _), document in objects.items() if each == kind]


def one(objects, kind, name_begins):
    found = [document for (each, name), document in objects.items() if each == kind and name.startswith(name_begins)]
    check(len(found) == 1, kind, name_begins, "is there", len(found), "times")
    return found[0]


def selects(selector, labels):
    return all(labels.get(name) == value for name, value in selector.items())


def write_secret(secret, volume, place):
    """Writes the files of a volume that has a Secret."""
    items = volume.get("items", [{"key": key, "path": key} for key in secret["data"]])
    for item in items:
        (place / item["path"]).write_bytes(base64.b64decode(secret["data"][item["key"]]))
        (place / item["path"]).chmod(volume["defaultMode"])


class Pod:
    """The pod of evpose-server with its options, variables and files."""

    def __init__(self, folder, objects, secrets):
        self.folder = folder
        self.deployment = one(objects, "Deployment", "evpose-server")
        template = self.deployment["spec"]["template"]
        self.labels = template["metadata"]["labels"]
        self.spec = template["spec"]
        check(len(self.spec["containers"]) == 1, folder, "has other containers")
        self.container = self.spec["containers"][0]
        self.sidecars = {container["name"]: container for container in self.spec["initContainers"]}
        check(all(container["restartPolicy"] == "Always" for container in self.sidecars.values()), folder, "has no sidecars")
        config_name = self.container["envFrom"][0]["configMapRef"]["name"]
        check(("ConfigMap", config_name) in objects, folder, "names a ConfigMap that is not there:", config_name)
        self.environment = dict(objects["ConfigMap", config_name]["data"])
        for entry in self.container["env"]:
            check(entry["valueFrom"]["resourceFieldRef"]["resource"] == "requests.cpu", entry)
            self.environment[entry["name"]] = self.container["resources"]["requests"]["cpu"]
        self.volumes = {volume["name"]: volume for volume in self.spec["volumes"]}
        self.secrets = secrets
        self.objects = objects

    def arguments(self):
        def value(match):
            check(match[1] in self.environment, self.folder, "has no", match[1])
            return self.environment[match[1]]

        return [re.sub(r"\$\((\w+)\)", value, argument) for argument in self.container["args"]]

    def mount(self, root):
        """Writes the pod's files below `root`, and returns the directory of each mount path."""
        places = {}
        for mount in self.container["volumeMounts"]:
            check(mount["name"] in self.volumes, self.folder, "mounts no volume:", mount)
            volume = self.volumes[mount["name"]]
            place = root / mount["mountPath"].lstrip("/")
            place.mkdir(parents=True)
            places[mount["mountPath"]] = place
            if "secret" in volume:
                name = volume["secret"]["secretName"]
                check(("Secret", name) in self.secrets, self.folder, "uses a Secret that no manifest defines:", name)
                check(mount["readOnly"], mount)
                write_secret(self.secrets["Secret", name], volume["secret"], place)
            else:
                claim = volume["persistentVolumeClaim"]["claimName"]
                check(("PersistentVolumeClaim", claim) in self.objects, self.folder, "has no", claim)
        used = {mount["name"] for container in [self.container, *self.sidecars.values()] for mount in container["volumeMounts"]}
        check(used == set(self.volumes), self.folder, "has volumes that nothing mounts")
        return places


def check_security(folder, objects):
    for document in of_kind(objects, "Deployment") + of_kind(objects, "StatefulSet"):
        spec = document["spec"]["template"]["spec"]
        who = document["metadata"]["name"]
        check(spec["securityContext"]["runAsNonRoot"] and spec["securityContext"]["runAsUser"] > 0, who, "may be root")
        check(spec["securityContext"]["seccompProfile"] == {"type": "RuntimeDefault"}, who, "seccomp")
        check(spec["automountServiceAccountToken"] is False, who, "has a token of the cluster")
        for container in spec["containers"] + spec.get("initContainers", []):
            context = container["securityContext"]
            check(context["readOnlyRootFilesystem"] is True, who, "may write its image")
            check(context["allowPrivilegeEscalation"] is False, who, "may gain privileges")
            check(context["capabilities"] == {"drop": ["ALL"]}, who, "has capabilities")
            check(container["resources"]["requests"].keys() == {"cpu", "memory"}, who, "requests")
            check("memory" in container["resources"]["limits"], who, "has no limit of memory")
            check(container["image"].rpartition(":")[2] not in ("", "latest"), who, "has no version")
        covered = [policy for policy in of_kind(objects, "NetworkPolicy")
                   if selects(policy["spec"]["podSelector"]["matchLabels"], document["spec"]["template"]["metadata"]["labels"])]
        check(len(covered) == 1 and covered[0]["spec"]["policyTypes"] == ["Ingress", "Egress"], who, "is open to the network")


def check_references(pod, objects):
    """Checks that selectors match the pod, and that ports have its names and numbers."""
    containers = [pod.container, *pod.sidecars.values()]
    numbers = {port["name"]: port["containerPort"] for container in containers for port in container.get("ports", [])}
    known = {*numbers, *numbers.values()}
    options = dict(argument[2:].split("=", 1) for argument in pod.arguments())
    proxy = one(objects, "ConfigMap", "evpose-haproxy")["data"]
    check(f" server {options['listen']} " in proxy["pod.cfg"], "HAProxy expects the server elsewhere than at", options["listen"])
    check(f"bind :{numbers['grpc']} " in proxy["tls.cfg"], "the port of gRPC differs from that of HAProxy")
    check(int(options["metrics-listen"].rpartition(":")[2]) == numbers["metrics"], "that of metrics from --metrics-listen")
    service = one(objects, "Service", "evpose-server")
    check(selects(service["spec"]["selector"], pod.labels), "the Service selects nothing")
    check(selects(pod.deployment["spec"]["selector"]["matchLabels"], pod.labels), "the Deployment selects nothing")
    for port in service["spec"]["ports"]:
        check(port["targetPort"] in known, "the Service's port", port)
    budget = one(objects, "PodDisruptionBudget", "evpose-server")
    check(selects(budget["spec"]["selector"]["matchLabels"], pod.labels), "the PodDisruptionBudget selects nothing")
    for policy in of_kind(objects, "NetworkPolicy"):
        for rule in policy["spec"]["ingress"] if policy["metadata"]["name"] == "evpose-server" else []:
            for port in rule["ports"]:
                check(port["port"] in known, "a NetworkPolicy names no port:", port)
    limit_bytes = int(pod.container["resources"]["limits"]["memory"].removesuffix("Gi")) << 30
    check(int(options["max-session-memory"]) + PREPARATION_BYTES + OTHER_BYTES <= limit_bytes, "a pod has too little memory")
    grace_s = pod.spec["terminationGracePeriodSeconds"]
    check(float(options["shutdown-notice"]) + float(options["shutdown-timeout"]) + 5 <= grace_s, "a pod is killed before the end of its shutdown timeout")
    return options


def check_scaling(objects, pod, metrics):
    scaler = one(objects, "HorizontalPodAutoscaler", "evpose-server")["spec"]
    check(("Deployment", scaler["scaleTargetRef"]["name"]) in objects, "the autoscaler scales nothing")
    check("replicas" not in pod.deployment["spec"], "an apply would reset the replicas of the autoscaler")
    check(scaler["minReplicas"] >= 3, "fewer than three servers")
    pods = scaler["metrics"][0]["pods"]
    check(int(pods["target"]["averageValue"]) < int(pod.environment["EVPOSE_MAX_SESSIONS"]), "pods fill before others come")
    check(int(pods["target"]["averageValue"]) < int(pod.environment["EVPOSE_TENANT_MAX_SESSIONS"]),
          "a single tenant reaches its limit before other pods come")
    load = scaler["metrics"][1]["pods"]
    check(int(load["target"]["averageValue"].removesuffix("m")) < 1000 * float(pod.environment["EVPOSE_MAX_LOAD"]),
          "pods refuse sessions because of their load before others come")
    adapter, load_rule = yaml.safe_load((MANIFESTS / "monitoring/prometheus-adapter.yaml").read_text())["rules"]["custom"]
    check(load_rule["name"]["as"] == load["metric"]["name"] and load_rule["seriesQuery"].split("{")[0] in metrics,
          "the autoscaler scales by a load that evpose-server or the adapter does not export")
    check(adapter["name"]["as"] == pods["metric"]["name"], "the adapter and the autoscaler name different metrics")
    check(adapter["seriesQuery"].split("{")[0] in metrics, "the adapter queries a metric that evpose-server does not export")
    check('evpose_sessions{state="closed"}' in metrics, "there is no state closed")
    alerts = pathlib.Path("deploy/prometheus/alerts.yml").read_text()
    check('state!="closed"' in adapter["metricsQuery"] and '(evpose_sessions{state!="closed"})' in alerts,
          "the autoscaler and the alert EvposeCapacity count different sessions")
    return scaler["maxReplicas"] * int(pod.environment["EVPOSE_MAX_SESSIONS"])


def check_service(objects, name, port):
    """Checks that a Service leads to the pods of its StatefulSet, and that NetworkPolicies admit servers to them. Returns the container."""
    service = objects["Service", name]["spec"]
    labels = objects["StatefulSet", name]["spec"]["template"]["metadata"]["labels"]
    check(objects["StatefulSet", name]["spec"]["serviceName"] == name, name, "belongs to another Service")
    check(service["ports"][0]["port"] == port, name, "listens elsewhere than at", port)
    check(selects(service["selector"], labels), "the Service selects nothing:", name)
    check(reaches(objects, "evpose-server", name, port), "servers may not reach", name)
    (container,) = objects["StatefulSet", name]["spec"]["template"]["spec"]["containers"]
    check({entry["name"]: entry["containerPort"] for entry in container["ports"]}[service["ports"][0]["targetPort"]] == port, name)
    return container


def reaches(objects, source, target, port):
    """Returns whether the NetworkPolicies of two kinds of pods allow connections from the source to a port of the target."""
    (container,) = objects["StatefulSet", target]["spec"]["template"]["spec"]["containers"]
    ports = {port, *(entry["name"] for entry in container["ports"] if entry["containerPort"] == port)}

    def allows(rules, way, peer):
        kind = "Deployment" if ("Deployment", peer) in objects else "StatefulSet"
        labels = objects[kind, peer]["spec"]["template"]["metadata"]["labels"]
        peers = [each for rule in rules if ports & {entry["port"] for entry in rule["ports"]} for each in rule[way]]
        return any(each.keys() == {"podSelector"} and selects(each["podSelector"]["matchLabels"], labels) for each in peers)

    egress, ingress = (objects["NetworkPolicy", name]["spec"] for name in (source, target))
    return allows(egress.get("egress", []), "to", target) and allows(ingress["ingress"], "from", source)


def check_redis(objects, pod, most_sessions):
    way = {entry["name"]: entry["value"] for entry in pod.sidecars["store"]["env"]}
    check(pod.environment["EVPOSE_STORE"] == "redis://" + way["STORE_BIND"], "the server's way to Redis is not encrypted")
    host, port = way["STORE_REDIS"].replace(".evpose.svc.cluster.local", "").split(":")
    container = check_service(objects, host, int(port))
    options = dict(zip(container["args"][::2], container["args"][1::2]))
    check(options["--port"] == "0" and options["--tls-port"] == port, "Redis accepts connections without TLS")
    check(options.get("--save") == "", "Redis writes snapshots beside its file of writes")
    check_redis_memory(container, options["--maxmemory"], most_sessions, other_bytes=0)
    check_redis_cores(pod, most_sessions)


def check_redis_memory(container, maxmemory, most_sessions, other_bytes):
    gigabytes = int(maxmemory.removesuffix("gb"))
    check(int(container["resources"]["limits"]["memory"].removesuffix("Gi")) >= 2 * gigabytes, "no room for the rewrite of Redis' file")
    check(most_sessions * SESSION_BYTES + other_bytes <= gigabytes * 2**30, most_sessions, "sessions have no room in Redis")


def check_redis_cores(pod, most_sessions):
    cores = most_sessions * SESSION_CORES
    check(cores <= MAX_REDIS_CORES, most_sessions, "sessions use too much of the core of Redis:", cores)
    statement = f"{most_sessions} sessions use {100 * cores:.0f} % of the core"
    check(statement in (MANIFESTS / pod.folder / "horizontalpodautoscaler.yaml").read_text(), "the autoscaler does not state:", statement)
    sizing = pathlib.Path("deploy/sizing.md").read_text()
    check(f"With {100 * SESSION_CORES:.2f} % of its core for a session" in sizing, "deploy/sizing.md has other costs of a session")


def check_group(objects, pod, most_sessions):
    """Checks names and rules of the group of Redis servers; sentinel_group_test.py runs it."""
    redis, sentinel = (check_service(objects, f"evpose-{kind}", port) for kind, port in (("redis", 6379), ("sentinel", 26379)))
    for source, target, port in (("redis", "redis", 6379), ("sentinel", "redis", 6379), ("sentinel", "sentinel", 26379)):
        check(reaches(objects, f"evpose-{source}", f"evpose-{target}", port), source, "may not reach", target)
    way = {entry["name"]: entry["value"] for entry in pod.sidecars["store"]["env"]}
    aliases = {name: alias["ip"] for alias in pod.spec["hostAliases"] for name in alias["hostnames"]}
    for kind, container in (("redis", redis), ("sentinel", sentinel)):
        name = f"evpose-{kind}"
        check(objects["Service", name]["spec"]["clusterIP"] == "None", name, "gives its pods no names")
        budget = objects["PodDisruptionBudget", name]["spec"]
        labels = objects["StatefulSet", name]["spec"]["template"]["metadata"]["labels"]
        check(budget["maxUnavailable"] == 1 and selects(budget["selector"]["matchLabels"], labels), name, "has no budget")
        names = [f"{name}-{i}.{name}.evpose.svc.cluster.local" for i in range(3)]
        check([way[f"{kind.upper()}_{i}"] for i in (1, 2, 3)] == names, "the tunnel leads elsewhere than to", names)
        check(container["args"][2] == "evpose-redis-0.evpose-redis.evpose.svc.cluster.local", container["args"])
        spec = objects["StatefulSet", name]["spec"]["template"]["spec"]
        (term,) = spec["affinity"]["podAntiAffinity"]["requiredDuringSchedulingIgnoredDuringExecution"]
        is_apart = term["topologyKey"] == "kubernetes.io/hostname" and selects(term["labelSelector"]["matchLabels"], labels)
        check(is_apart, "two pods of", name, "may share a machine")
        (constraint,) = spec["topologySpreadConstraints"]
        check(constraint["topologyKey"] == "topology.kubernetes.io/zone", name, constraint)
        check(selects(constraint["labelSelector"]["matchLabels"], labels), name, "is not spread over zones")
    check(aliases == {way[f"REDIS_{i}"]: f"127.0.1.{i}" for i in (1, 2, 3)}, "the server does not find the tunnels:", aliases)
    config = objects["ConfigMap", pod.volumes["haproxy"]["configMap"]["name"]]["data"]["store-sentinel.cfg"]
    for i in (1, 2, 3):
        for port in (6379, 26379):
            check(f"bind 127.0.1.{i}:{port}\n" in config, "the tunnel does not listen at", i, port)
    stores = ",".join(f"127.0.1.{i}:26379" for i in (1, 2, 3))
    check(pod.environment["EVPOSE_STORE"] == f"redis+sentinel://{stores}/evpose", "the server's way to the Sentinels is not encrypted")
    files = one(objects, "ConfigMap", "evpose-redis-group")["data"]
    settings = dict(line.split(maxsplit=1) for line in files["node.conf"].splitlines() if line and line[0] != "#")
    check(settings["port"] == "0" and settings["tls-port"] == "6379", "Redis accepts connections without TLS")
    backlog_bytes = int(settings["repl-backlog-size"].removesuffix("mb")) << 20
    check_redis_memory(redis, settings["maxmemory"], most_sessions, backlog_bytes)
    check_redis_cores(pod, most_sessions)


def check_monitoring(pod, objects):
    monitoring = RENDERER.render("monitoring")
    monitor = one(monitoring, "ServiceMonitor", "evpose-server")["spec"]
    service = one(objects, "Service", "evpose-server")
    check(selects(monitor["selector"]["matchLabels"], service["metadata"]["labels"]), "the ServiceMonitor selects nothing")
    check(service["metadata"]["labels"][monitor["jobLabel"]] == "evpose", "the alerts use another name for the job")
    check(monitor["endpoints"][0]["port"] in [port["name"] for port in service["spec"]["ports"]], "ServiceMonitor's port")
    rule = one(monitoring, "PrometheusRule", "evpose")["spec"]
    check(rule == yaml.safe_load(pathlib.Path("deploy/prometheus/alerts.yml").read_text()), "other alerts than Prometheus's")


class Redis:
    """Starts a Redis with the options of the overlay, at a socket instead of its port."""

    def __init__(self, objects, secrets, root):
        spec = objects["StatefulSet", "evpose-redis"]["spec"]["template"]["spec"]
        volume = spec["volumes"][0]["secret"]
        write_secret(secrets["Secret", volume["secretName"]], volume, root)
        container = spec["containers"][0]
        changes = {"/data": str(root), "6379": "0"}
        arguments = [changes.get(text, text).replace("/run/secrets", str(root)) for text in container["args"]]
        self.socket = root / "socket"
        self.process = subprocess.Popen(
            container["command"] + arguments + ["--unixsocket", str(self.socket)],
            stdout=subprocess.PIPE, text=True)
        for line in self.process.stdout:
            if "ready to accept connections at" in line:
                break
        else:
            check(False, "redis-server does not start")

    def end(self):
        self.process.kill()
        self.process.communicate()


def get(address, path):
    try:
        with urllib.request.urlopen(f"http://{address}{path}", timeout=30) as answer:
            return answer.status, answer.read().decode()
    except urllib.error.HTTPError as error:
        return error.code, ""


def run_server(pod, root, redis):
    """Starts the server as in the pod, runs the probes, and ends it, as the kubelet does; returns /metrics."""
    places = pod.mount(root)

    def here(text):
        for there, place in places.items():
            text = text.replace(there, str(place))
        return re.sub(r"(0\.0\.0\.0|127\.0\.0\.1):\d+", r"\1:0", text)

    environment = {"PATH": os.environ["PATH"], **{name: here(value) for name, value in pod.environment.items()}}
    if redis is not None:
        environment["EVPOSE_STORE"] = f"redis+unix://{redis.socket}"
    process = subprocess.Popen([SERVER] + [here(argument) for argument in pod.arguments()], env=environment,
                               stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        lines = [process.stdout.readline(), process.stdout.readline()]
        if not lines[1].startswith("metrics on "):
            process.kill()
            check(False, pod.folder, "the server does not start with the pod's options:", process.communicate()[1])
        address = "127.0.0.1:" + lines[1].strip().rpartition(":")[2]
        for probe in ("startupProbe", "livenessProbe", "readinessProbe"):
            asked = pod.container[probe]["httpGet"]
            check(asked["port"] == "metrics" and get(address, asked["path"])[0] == 200, probe, asked, "is not answered")
        metrics = get(address, "/metrics")[1]
        process.send_signal(signal.SIGTERM)
        _, log = process.communicate()
    finally:
        process.kill()
        process.wait()
    check(process.returncode == 0, pod.folder, "the server ended with", process.returncode, log)
    events = [json.loads(line) for line in log.splitlines()]
    check("server_ready" in [event["event"] for event in events], log)
    check(all(event["level"] == "info" for event in events), pod.folder, "the server warns:", log)
    return metrics


def check_overlay(folder, secrets, version, redis):
    objects = RENDERER.render(folder)
    pod = Pod(folder, objects, secrets)
    check(pod.container["terminationMessagePolicy"] == "FallbackToLogsOnError", folder, "hides why a server does not start")
    check(pod.container["image"] == f"evpose-server:{version}", folder, pod.container["image"], "is not", version)
    check_security(folder, objects)
    check_references(pod, objects)
    root = WORK / folder
    root.mkdir(parents=True)
    is_single = folder == "overlays/single"
    metrics = run_server(pod, root, None if is_single else redis)
    workers = int(pod.container["resources"]["requests"]["cpu"])
    check(f"\nevpose_workers {workers}\n" in metrics, folder, "does not have a worker for each core")
    check(f"\nevpose_max_sessions {pod.environment['EVPOSE_MAX_SESSIONS']}\n" in metrics, folder, "max_sessions")
    if is_single:
        check(pod.deployment["spec"]["strategy"]["type"] == "Recreate", "two writers of one file")
        check(pod.deployment["spec"]["replicas"] == 1, "more than one writer")
        check((root / "var/lib/evpose/evpose.db").exists(), "sessions are not on the volume")
    else:
        most_sessions = check_scaling(objects, pod, metrics)
        check_store = check_redis if folder == "overlays/cluster" else check_group
        check_store(objects, pod, most_sessions)
    check_monitoring(pod, objects)


def main():
    secrets = {folder: RENDERER.render(folder) for folder in SECRETS}
    version = subprocess.run([SERVER, "--version"], capture_output=True, text=True, check=True).stdout.split()[1]
    # The Redis of the overlay cluster is the store of the servers of both overlays that share one.
    (WORK / "store").mkdir()
    redis = Redis(RENDERER.render("overlays/cluster"), secrets["secrets/redis"], WORK / "store")
    try:
        for folder, needed in OVERLAYS.items():
            given = {name: document for part in needed for name, document in secrets[part].items()}
            check_overlay(folder, given, version, redis)
    finally:
        redis.end()
    print("deploy/kubernetes:", len(OVERLAYS), "overlays are consistent")


main()
