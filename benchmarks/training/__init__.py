"""What training costs, and what it reaches."""
