"""The joint space, and the space about an arm, as networks have them."""
