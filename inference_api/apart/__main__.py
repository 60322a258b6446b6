"""``python -m inference_api.apart ROLE``: one child process, started by the API and by nobody else."""

import sys

from inference_api.apart.serving import serve

if __name__ == "__main__":
    serve(sys.argv[1])
