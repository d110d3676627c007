# SPDX-License-Identifier: Apache-2.0
# Images of Prometheus, Redis and HAProxy made from Debian's packages. They replace the images of the compose files where no registry
# can be reached, with the same programs, users and directories.
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
