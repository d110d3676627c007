#!/usr/bin/env bash
# SPDX-License-Identifier: Apache-2.0
# Tests alerts, metrics and dashboard: Prometheus accepts them, Grafana's files are consistent, each alert fires when it should, and
# alerts, panels, manifests and documents name only metrics that the server has.
#   tests/monitoring_test.sh EVPOSE_SERVER
set -euo pipefail
server=$(realpath "${1:?usage: $0 EVPOSE_SERVER}")
cd "$(dirname "${BASH_SOURCE[0]}")/../deploy"

for file in prometheus cluster; do promtool check config "prometheus/$file.yml"; done
promtool test rules prometheus/alerts_test.yml

# A server without tokens has no metric of their number.
tokens=$(mktemp)
"$server" --new-token lab --token-file "$tokens" >/dev/null 2>&1
coproc evpose { exec "$server" --store memory --listen 127.0.0.1:0 --metrics-listen 127.0.0.1:0 --token-file "$tokens" --log-level off; }
# shellcheck disable=SC2154  # coproc sets evpose_PID
trap 'kill "$evpose_PID"; rm "$tokens"' EXIT
read -r _ <&"${evpose[0]}"
read -r _ _ address <&"${evpose[0]}"

/usr/bin/python3 - "$address" "$server" <<'PYTHON'
import json, pathlib, re, subprocess, sys, tempfile, urllib.request

import yaml

sys.path.insert(0, "../tests")
from checks import poll
from processes import Redis, Server

page = urllib.request.urlopen(f"http://{sys.argv[1]}/metrics").read().decode()
# OpenMetrics, as Prometheus asks for it: the parser of Prometheus's Python client is strict.
from prometheus_client.openmetrics import parser

request = urllib.request.Request(f"http://{sys.argv[1]}/metrics", headers={
    "Accept": "application/openmetrics-text;version=1.0.0,application/openmetrics-text;version=0.0.1;q=0.75,text/plain;version=0.0.4;q=0.5"})
answer = urllib.request.urlopen(request)
assert answer.headers["Content-Type"] == "application/openmetrics-text; version=1.0.0; charset=utf-8", answer.headers
open_metrics = {sample.name for family in parser.text_string_to_metric_families(answer.read().decode()) for sample in family.samples}
assert open_metrics == {name for name in re.findall(r"^(evpose_\w+)", page, re.M)}, "the two formats have different series"
# Checks names and help texts against Prometheus's rules.
subprocess.run(["promtool", "check", "metrics"], input=page, text=True, check=True)
# Some metrics exist with Redis only, after the first check of the store.
with tempfile.TemporaryDirectory() as folder, Redis(folder) as redis, Server(sys.argv[2], "--store", redis.url, store=None) as with_redis:
    def page_with_redis():
        text = with_redis.page("/metrics")[1]
        return text if "evpose_store_cpu_seconds_total " in text else None
    pages = page + poll(page_with_redis, "the processor time of Redis")
exported, histograms = set(), set()
for name, kind in re.findall(r"^# TYPE (\w+) (\w+)$", pages, re.M):
    exported |= {f"{name}_{part}" for part in ("bucket", "sum", "count")} if kind == "histogram" else {name}
    histograms |= {name} if kind == "histogram" else set()

def check(where, used):
    unknown = sorted(set(used) - exported)
    if unknown:
        sys.exit(f"{where} uses {', '.join(unknown)}, which evpose-server does not have")

check("prometheus/alerts.yml", re.findall(r"\bevpose_\w+", pathlib.Path("prometheus/alerts.yml").read_text()))
dashboard = json.loads(pathlib.Path("grafana/evpose.json").read_text())
charts = [panel for panel in dashboard["panels"] if panel["type"] != "row"]
expressions = [target["expr"] for panel in charts for target in panel["targets"]]
check("grafana/evpose.json", re.findall(r"\bevpose_\w+", " ".join(expressions)))

# Manifests have the names of metrics and no other names with this prefix.
for path in pathlib.Path("kubernetes").rglob("*.yaml"):
    check(path, re.findall(r"\bevpose_\w+", path.read_text()))

# Documents omit the prefix, and name a histogram without its parts. `_x` continues the name before it.
exported |= histograms
metrics_section = pathlib.Path("README.md").read_text().split("\n## Metrics\n")[1].split("\n## ")[0]
num_named = 0
for row in re.findall(r"^\| .*\? \| (.*)$", metrics_section, re.M):
    spans = re.sub(r"\{[^}]*\}|\[\w+\]", "", " ".join(re.findall(r"`([^`]+)`", row)))
    names = re.findall(r"(?<![\w-])[a-z]\w*\b(?!\()", spans)
    check("the table of metrics in deploy/README.md", [f"evpose_{name}" for name in names])
    num_named += len(names)
assert num_named > 40, f"the table of metrics in deploy/README.md was not found: {num_named} names"
for path in pathlib.Path("..").glob("[!.b]*/**/*.md"):
    text = path.read_text()
    check(path, [f"evpose_{name}" for name in re.findall(r"`([a-z]\w+_total)\b", text) if not name.startswith("evpose_")])
    check(path, re.findall(r"\bevpose_\w+_(?:total|bytes|ratio|sessions|up)\b", text))

ids = [panel["id"] for panel in dashboard["panels"]]
assert len(ids) == len(set(ids)), "two panels have one id"
cells = set()
for panel in dashboard["panels"]:
    place = panel["gridPos"]
    mine = {(place["x"] + i, place["y"] + j) for i in range(place["w"]) for j in range(place["h"])}
    assert place["x"] + place["w"] <= 24 and not mine & cells, f"{panel['title']} lies over another panel"
    cells |= mine

# Grafana's files: the dashboard is in the provider's directory, and its panels use the provisioned data source.
provisioning = pathlib.Path("grafana/provisioning")
[source] = yaml.safe_load((provisioning / "datasources/prometheus.yml").read_text())["datasources"]
[provider] = yaml.safe_load((provisioning / "dashboards/evpose.yml").read_text())["providers"]
services = yaml.safe_load(pathlib.Path("compose.yaml").read_text())["services"]
mounts = dict(volume.split(":")[:2] for volume in services["grafana"]["volumes"])
assert mounts["./grafana/provisioning"] == "/etc/grafana/provisioning", "the provisioning files are not mounted"
assert mounts["./grafana/evpose.json"] == provider["options"]["path"] + "/evpose.json", "the dashboard is not mounted in the provider's directory"
assert source["url"] == "http://prometheus:9090" and "prometheus" in services, "the data source does not have the address of a service"
users = charts + [target for panel in charts for target in panel["targets"]] + dashboard["templating"]["list"]
for user in users:
    name = user.get("title") or user.get("refId") or user["name"]
    assert user["datasource"] == {"type": source["type"], "uid": source["uid"]}, f"{name} uses {user['datasource']}"

# Prometheus parses the expressions.
rules = [{"record": f"chart:{i}", "expr": text.replace("$instance", ".*")} for i, text in enumerate(expressions)]
with tempfile.NamedTemporaryFile("w", suffix=".yml") as file:
    json.dump({"groups": [{"name": "charts", "rules": rules}]}, file)
    file.flush()
    subprocess.run(["promtool", "check", "rules", file.name], check=True)
PYTHON
