"""What a picture is to a network: autoencoders of pictures and of observed cells, and how new one is."""
