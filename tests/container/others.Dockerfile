# SPDX-License-Identifier: Apache-2.0
# Prometheus, Redis and HAProxy out of Debian's packages, in the place of the images that the compose files name, where no
# registry is to be had. Programs, users and directories are where those images have them.
FROM debian:bookworm-slim AS packages
RUN apt-get update -qq

FROM packages AS prometheus
RUN DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends prometheus && install -d -o 65534 -g 65534 /prometheus
USER nobody
VOLUME /prometheus
WORKDIR /prometheus
ENTRYPOINT ["/bin/prometheus"]

FROM packages AS redis
RUN DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends redis-server && install -d -o 999 -g 999 /data
VOLUME /data
WORKDIR /data

FROM packages AS haproxy
RUN DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends haproxy
USER 99:99
STOPSIGNAL SIGUSR1
