# The tracking server and model registry: MLflow with a driver for Postgres, nothing of this project.
FROM python:3.11-slim-bookworm

ENV MLFLOW_DISABLE_TELEMETRY=true \
    MLFLOW_SERVER_ENABLE_JOB_EXECUTION=false \
    PYTHONUNBUFFERED=1

COPY constraints.txt docker/mlflow.txt /tmp/
RUN pip install --no-cache-dir --only-binary :all: -c /tmp/constraints.txt pip \
 && pip install --no-cache-dir --only-binary :all: -c /tmp/constraints.txt -r /tmp/mlflow.txt

RUN useradd --uid 1000 --create-home mlflow \
 && install -d -o mlflow -g mlflow /var/lib/mlflow
USER 1000
WORKDIR /var/lib/mlflow
EXPOSE 5000
CMD ["mlflow", "server", "--host", "0.0.0.0", "--port", "5000"]
