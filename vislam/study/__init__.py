"""Monte-Carlo studies: a comparison repeated over seeds and over values of its config, on many processes."""
