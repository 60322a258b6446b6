"""The camera above, and its pictures: from untrusted bytes to network input."""
