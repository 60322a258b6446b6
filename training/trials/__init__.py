"""The trials, a Ray task each: VAE, gate, WGAN-GPs and path models."""
