"""How a question travels: the request, the network within a deadline, the answer as it comes in."""
