"""Where the inference API is that a shell means."""

import os

API_URL = "CSPACE_API_URL"
"""The variable that ``python -m services.local env`` sets in a shell."""
_USUAL = "http://127.0.0.1:8000"


def usual_api() -> str:
    """The address that the shell names, or that of the default set-up."""
    return os.environ.get(API_URL) or _USUAL
