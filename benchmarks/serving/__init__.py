"""What requests to the API take."""
