# The inference API: onnxruntime, FastAPI and the compiled search of plans, no training framework. Build context: the repository.
ARG PYTHON_IMAGE=python:3.11-slim-bookworm@sha256:a36c24f9cbdf4fd0f52d67f0823eeac19c2028c637cecc392d97f980d4fec56b
FROM ${PYTHON_IMAGE}
COPY docker/api.txt /tmp/
RUN pip install --no-cache-dir --only-binary :all: --no-deps --require-hashes -r /tmp/api.txt

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
