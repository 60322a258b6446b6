"""The page at ``/``, and what it may ask beside the contract's pages; the contract does not know of it."""
