"""What enters a search: drawn and uniform configurations, mixed and in an order."""
