"""Bodies of requests: forms and JSON, counted before they are parsed."""
