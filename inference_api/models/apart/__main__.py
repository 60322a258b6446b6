"""``python -m inference_api.models.apart ROLE``: one child process, started by the API and by nobody else."""

import sys

from inference_api.models.apart.processes.serving import serve

if __name__ == "__main__":
    serve(sys.argv[1])
