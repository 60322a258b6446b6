"""The page at ``/``, and the routes that it alone uses."""
