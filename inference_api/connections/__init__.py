"""What a client may do with a connection before any guard sees a request."""
