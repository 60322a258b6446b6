"""The HTTP service: pictures in, configurations and paths out. docs/architecture.md lists a request's stops."""
