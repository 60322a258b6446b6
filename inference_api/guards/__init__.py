"""What stands before the pages: keys, limits and headers, each an ASGI middleware of its own."""
