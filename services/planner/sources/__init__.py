"""Where samples come from: the API over HTTP, or a bundle in this process."""
