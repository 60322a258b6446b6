# Debian's nginx for two services of the stack: the way to the inference API, and that container's view of MLflow.
ARG DEBIAN_IMAGE=debian:bookworm-slim@sha256:88200866dfff7ea7f5cbcb6ec7c8a701889efe6fe859fe64d6990e4b07ea4171
FROM ${DEBIAN_IMAGE}
# No version: building again brings Debian's security fixes.
# hadolint ignore=DL3008
RUN apt-get update \
 && apt-get install -y --no-install-recommends nginx-light \
 && rm -rf /var/lib/apt/lists/* \
 && useradd --uid 1000 cspace
COPY docker/nginx /etc/cspace-nginx
USER 1000
EXPOSE 8080
CMD ["nginx", "-e", "stderr", "-g", "daemon off;", "-c", "/etc/cspace-nginx/edge.conf"]
