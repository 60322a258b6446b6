"""The Ray Tune trials: VAE, one WGAN-GP a cluster, the global WGAN-GP. The only code that knows Tune."""
