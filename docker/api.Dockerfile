# The inference API: onnxruntime, FastAPI and the compiled search of plans, no training framework. Build context: the repository.
FROM python:3.11-slim-bookworm AS requirements
WORKDIR /src
COPY pyproject.toml docker/requirements.py ./
COPY clients/python/pyproject.toml clients/python/
RUN python requirements.py api plan signing tracing > /requirements.txt

FROM python:3.11-slim-bookworm
COPY --from=requirements /requirements.txt /tmp/requirements.txt
COPY constraints.txt /tmp/constraints.txt
RUN pip install --no-cache-dir --only-binary :all: -c /tmp/constraints.txt pip \
 && pip install --no-cache-dir --only-binary :all: -c /tmp/constraints.txt -r /tmp/requirements.txt

RUN useradd --uid 1000 --create-home cspace \
 && install -d -o cspace -g cspace /var/lib/cspace/models /var/lib/outcomes /opt/cspace/kernels
COPY clients/python/src/cspace_client /app/cspace_client
COPY cspace /app/cspace
COPY services /app/services
COPY inference_api /app/inference_api

ENV CSPACE_MODEL_CACHE=/var/lib/cspace/models \
    NUMBA_CACHE_DIR=/opt/cspace/kernels \
    MLFLOW_DISABLE_TELEMETRY=true \
    OMP_NUM_THREADS=1 \
    PYTHONPATH=/app \
    PYTHONUNBUFFERED=1
USER 1000
WORKDIR /app
# Compiled for processors like this one, and found where the root file system is read only. On another processor a
# server compiles when it starts, and is ready after a minute.
RUN python -m cspace.plan
EXPOSE 8000
CMD ["python", "-m", "inference_api", "--host", "0.0.0.0", "--port", "8000"]
