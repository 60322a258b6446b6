# The tracking server and model registry: MLflow with a driver for Postgres, nothing of this project.
ARG PYTHON_IMAGE=python:3.11-slim-bookworm@sha256:a36c24f9cbdf4fd0f52d67f0823eeac19c2028c637cecc392d97f980d4fec56b
FROM ${PYTHON_IMAGE}

ENV MLFLOW_DISABLE_TELEMETRY=true \
    MLFLOW_SERVER_ENABLE_JOB_EXECUTION=false \
    PYTHONUNBUFFERED=1

COPY docker/mlflow.txt /tmp/
RUN pip install --no-cache-dir --only-binary :all: --no-deps --require-hashes -r /tmp/mlflow.txt

RUN useradd --uid 1000 --create-home mlflow \
 && install -d -o mlflow -g mlflow /var/lib/mlflow
USER 1000
WORKDIR /var/lib/mlflow
EXPOSE 5000
CMD ["mlflow", "server", "--host", "0.0.0.0", "--port", "5000"]
