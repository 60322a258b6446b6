# Every Ray node and the one-shot jobs: the training stack and the project's sources. Build context: the repository.
ARG PYTHON_IMAGE=python:3.11-slim-bookworm@sha256:a36c24f9cbdf4fd0f52d67f0823eeac19c2028c637cecc392d97f980d4fec56b
FROM ${PYTHON_IMAGE}
# On Linux, torch's default package brings several GB of CUDA libraries; PyTorch's index for processors avoids them.
# Nothing but torch is taken from there: an index that supplies every package could replace any of them. Its builds have
# other hashes than those of docker/torch.txt.
ARG TORCH_INDEX_URL=""
COPY docker/torch.txt docker/ray.txt /tmp/
RUN if [ -n "$TORCH_INDEX_URL" ]; then \
      pip install --no-cache-dir --only-binary :all: --no-deps --index-url "$TORCH_INDEX_URL" \
        "$(sed -n 's/^\(torch==[^ ]*\).*/\1/p' /tmp/torch.txt)"; \
    else \
      pip install --no-cache-dir --only-binary :all: --no-deps --require-hashes -r /tmp/torch.txt; \
    fi \
 && pip install --no-cache-dir --only-binary :all: --no-deps --require-hashes -r /tmp/ray.txt

RUN useradd --uid 1000 --create-home cspace \
 && install -d -o cspace -g cspace /var/lib/cspace /var/lib/outcomes
COPY clients/python/src/cspace_client /app/cspace_client
COPY cspace /app/cspace
# The shipped models, which users name `pretrained` and `pretrained-panda`.
COPY inference_api/pretrained /app/inference_api/pretrained
COPY inference_api/pretrained_panda /app/inference_api/pretrained_panda
COPY services /app/services
COPY training /app/training

ARG GIT_COMMIT=unknown
ENV CSPACE_GIT_COMMIT=${GIT_COMMIT} \
    MLFLOW_DISABLE_TELEMETRY=true \
    NUMBA_CACHE_DIR=/tmp/numba \
    OMP_NUM_THREADS=1 \
    PYTHONPATH=/app \
    PYTHONUNBUFFERED=1 \
    RAY_DEDUP_LOGS=0 \
    RAY_USAGE_STATS_ENABLED=0
USER 1000
WORKDIR /app
EXPOSE 6379 8265
