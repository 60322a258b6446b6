"""The Ray Tune trials: VAE, gate, WGAN-GPs, path models, searches. The only code that knows Tune."""
