# Debian's nginx for two services of the stack: the way to the inference API, and that container's view of MLflow.
FROM debian:bookworm-slim
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
