"""``POST /plan``."""
