"""Measurements, each by its command; nothing else imports them."""
