# The inference API: onnxruntime and FastAPI, no training framework. Build context: the repository.
FROM python:3.11-slim-bookworm AS requirements
WORKDIR /src
COPY pyproject.toml docker/requirements.py ./
RUN python requirements.py api tracing > /requirements.txt

FROM python:3.11-slim-bookworm
ARG PIP_EXTRA_INDEX_URL=""
COPY --from=requirements /requirements.txt /tmp/requirements.txt
COPY constraints.txt /tmp/constraints.txt
RUN pip install --no-cache-dir -c /tmp/constraints.txt -r /tmp/requirements.txt

RUN useradd --uid 1000 --create-home cspace \
 && install -d -o cspace -g cspace /var/lib/cspace/models
COPY cspace /app/cspace
COPY services /app/services
COPY inference_api /app/inference_api

ENV CSPACE_MODEL_CACHE=/var/lib/cspace/models \
    MLFLOW_DISABLE_TELEMETRY=true \
    OMP_NUM_THREADS=1 \
    PYTHONPATH=/app \
    PYTHONUNBUFFERED=1
USER 1000
WORKDIR /app
EXPOSE 8000
CMD ["python", "-m", "inference_api", "--host", "0.0.0.0", "--port", "8000"]
