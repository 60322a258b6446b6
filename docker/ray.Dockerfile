# Every Ray node and the one-shot jobs: the training stack and the project's sources. Build context: the repository.
FROM python:3.11-slim-bookworm AS requirements
WORKDIR /src
COPY pyproject.toml docker/requirements.py ./
COPY clients/python/pyproject.toml clients/python/
RUN python requirements.py train > /requirements.txt

FROM python:3.11-slim-bookworm
# On Linux, torch's default package brings several GB of CUDA libraries; PyTorch's index for processors avoids them.
# Nothing but torch is taken from there: an index that supplies every package could replace any of them.
ARG TORCH_INDEX_URL=""
# The requirements come from a stage of their own: the heavy layer is rebuilt when they change, not when code does.
COPY --from=requirements /requirements.txt /tmp/requirements.txt
COPY constraints.txt /tmp/constraints.txt
RUN pip install --no-cache-dir --only-binary :all: -c /tmp/constraints.txt pip \
 && pip install --no-cache-dir --only-binary :all: -c /tmp/constraints.txt --no-deps \
      ${TORCH_INDEX_URL:+--index-url "$TORCH_INDEX_URL"} torch \
 && pip install --no-cache-dir --only-binary :all: -c /tmp/constraints.txt -r /tmp/requirements.txt

RUN useradd --uid 1000 --create-home cspace \
 && install -d -o cspace -g cspace /var/lib/cspace /var/lib/outcomes
COPY clients/python/src/cspace_client /app/cspace_client
COPY cspace /app/cspace
# The shipped models, which the evaluation compares with.
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
