# SPDX-License-Identifier: Apache-2.0
# An image of Prometheus made from Debian's packages. It replaces that of the compose files where no registry can be reached, with
# the same program, user and directory.
ARG BASE_IMAGE=debian:bookworm-slim
FROM ${BASE_IMAGE}
RUN apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends prometheus && install -d -o 65534 -g 65534 /prometheus
USER nobody
VOLUME /prometheus
WORKDIR /prometheus
ENTRYPOINT ["/bin/prometheus"]
