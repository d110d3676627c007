#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Runs the three Redis servers, three Sentinels and the tunnels of compose.sentinel.yaml, or those of the overlay sentinel for
Kubernetes, as processes, with the files that they mount.

usage: sentinel_group_test.py EVPOSE_SERVER compose|kubernetes

Kills the master: the Sentinels must agree on one of the replicas, which accepts writes and has the data, the killed node must follow it
when it starts again, and evpose-server must be ready again without a restart. Nodes that restart keep their roles. A master that has
lost both replicas must reject writes. Names are resolved as in the containers: each process has a mount namespace with a hosts file of its
own, so the test needs root, and is skipped without (status 77). Ports are free ones instead of 6379 and 26379.
"""
import contextlib
import os
import pathlib
import re
import socket
import subprocess
import sys
import tempfile
import urllib.request

import manifests
from checks import check, poll
from processes import free_ports
from redis_group import NAMES, SENTINELS, Group, Layout, compose_layout

SERVER = os.path.realpath(sys.argv[1])


def kubernetes_layout(work):
    objects = manifests.Renderer(manifests.copy(work / "manifests")).render("overlays/sentinel")
    hosts, commands, probes, files = {}, {}, {}, {}
    for kind, nodes in (("redis", NAMES), ("sentinel", SENTINELS)):
        stateful = objects["StatefulSet", f"evpose-{kind}"]
        spec = stateful["spec"]["template"]["spec"]
        container = spec["containers"][0]
        check(stateful["spec"]["replicas"] == len(nodes), kind, "has another number of nodes")
        check(container["env"] == [{"name": "POD", "valueFrom": {"fieldRef": {"fieldPath": "metadata.name"}}}], container["env"])
        # The names that a StatefulSet with a headless Service has in the DNS.
        for i, node in enumerate(nodes):
            pod = f"{stateful['metadata']['name']}-{i}"
            hosts[node] = f"{pod}.{stateful['spec']['serviceName']}.evpose.svc.cluster.local"
            commands[node] = [*container["command"], *(word.replace("$(POD)", pod) for word in container["args"])][1:]
            probes[node] = container["readinessProbe"]["exec"]["command"]
        volumes = {volume["name"]: volume for volume in spec["volumes"]}
        paths = {mount["mountPath"]: mount["name"] for mount in container["volumeMounts"]}
        files.update(objects["ConfigMap", volumes[paths["/etc/redis-group"]]["configMap"]["name"]]["data"])
    server = objects["Deployment", "evpose-server"]["spec"]["template"]["spec"]
    (tunnel,) = (container for container in server["initContainers"] if container["name"] == "store")
    config = objects["ConfigMap", server["containers"][0]["envFrom"][0]["configMapRef"]["name"]]["data"]
    return Layout(
        hosts=hosts, commands=commands, probes=probes, files=files,
        aliases={name: alias["ip"] for alias in server["hostAliases"] for name in alias["hostnames"]},
        tunnel=tunnel["args"],
        tunnel_environment={entry["name"]: entry["value"] for entry in tunnel["env"]},
        # The other options of the pod are those of kubernetes_test.py.
        server=["--listen", "0.0.0.0:0", "--insecure", "--metrics-listen", "0.0.0.0:0", "--store", config["EVPOSE_STORE"],
                "--store-password-file", "/run/secrets/redis.password"])


def is_ready(address):
    try:
        with urllib.request.urlopen(f"http://{address}/readyz", timeout=5) as page:
            return page.status == 200
    except OSError:  # not ready, or not reachable
        return False


def check_failover(group, address):
    poll(lambda: is_ready(address), "the server is ready")
    first = group.await_master(2)
    poll(lambda: group.cli(first, "set", "evpose-test", "kept") == "OK", "the first master accepts a write")
    poll(lambda: group.cli(first, "wait", "2", "1000") == "2", "both replicas have the write")
    poll(lambda: all(group.is_ready(name) for name in (*NAMES, *SENTINELS)), "all nodes and Sentinels are healthy")
    other = next(name for name in NAMES if name != first)
    check("READONLY" in group.cli(other, "set", "evpose-test", "wrong"), "a replica accepts a write")
    group.kill(first)
    check(not group.is_ready(first), "a node that was killed is healthy")
    master = group.await_master(1)
    check(group.cli(master, "get", "evpose-test") == "kept", "the new master lacks a write that both replicas had")
    poll(lambda: group.cli(master, "set", "evpose-test", "new") == "OK", "the new master accepts a write")
    poll(lambda: is_ready(address), "the server is ready again")
    check(group.processes["server-1"].poll() is None, "the server has ended")
    group.start_node(first)
    poll(lambda: group.replicas(master) == 2, "the node that was killed follows the new master")
    poll(lambda: group.cli(first, "get", "evpose-test") == "new", "the node that was killed has the new value")
    roles = group.roles()
    check(sorted(roles.values()) == ["master", "slave", "slave"] and roles[master] == "master", "after the return the roles are", roles)
    return master


def check_restart(group, master):
    """A node that restarts keeps the role that the Sentinels gave it, also without them."""
    group.kill(*NAMES, *SENTINELS)
    for name in NAMES:
        group.start_node(name)
    roles = group.roles()
    check(sorted(roles.values()) == ["master", "slave", "slave"] and roles[master] == "master", "after a restart of all the roles are", roles)
    check(group.cli(master, "get", "evpose-test") == "new", "a restart of all loses writes")


def check_loss_of_two(group, master):
    """A master without replicas rejects writes, and accepts them when one has returned."""
    others = [name for name in NAMES if name != master]
    group.kill(*others)
    poll(lambda: "NOREPLICAS" in group.cli(master, "set", "evpose-test", "lost"), "a master without replicas rejects writes")
    # The health check of compose only tells whether a node responds.
    check(group.is_ready(master) == (sys.argv[2] == "compose"), "the health of a master without replicas is", group.is_ready(master))
    group.start_node(others[0])
    poll(lambda: group.cli(master, "set", "evpose-test", "back") == "OK", "the master accepts writes again")
    poll(lambda: group.cli(others[0], "get", "evpose-test") == "back", "the replica has the value")


def main():
    if os.geteuid() != 0 or subprocess.run(["unshare", "--mount", "true"], capture_output=True).returncode != 0:
        print("sentinel_group_test: SKIPPED: needs root, for mount namespaces")
        sys.exit(77)
    with tempfile.TemporaryDirectory() as work, contextlib.ExitStack() as stack:
        work = pathlib.Path(work)
        layout = compose_layout() if sys.argv[2] == "compose" else kubernetes_layout(work)
        group = Group(work, stack, layout, {name: f"127.0.2.{name[-1]}" for name in layout.hosts}, ports=free_ports(2))
        for name in (*NAMES, *SENTINELS):
            group.start_node(name)
        group.await_master(2)
        with socket.create_connection((group.addresses["redis-1"], group.redis_port)) as plain, contextlib.suppress(ConnectionResetError):
            plain.sendall(b"PING\r\n")
            check(not plain.recv(100).startswith((b"+", b"-")), "Redis responds without encryption")
        group.start_tunnel("server-1")
        options = [re.sub(r"^0\.0\.0\.0:\d+$", "127.0.0.1:0", word) for word in group.server_options()]
        address = re.search(r"127\.0\.0\.1:\d+", group.start_server(SERVER, "server-1", options)[1])[0]
        master = check_failover(group, address)
        check_restart(group, master)
        check_loss_of_two(group, master)
        print("a killed master was replaced by", master, "and follows it; roles and writes outlast a restart of all three")


main()
