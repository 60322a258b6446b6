"""What the server tells about itself: metrics, one log line a request, request ids."""
