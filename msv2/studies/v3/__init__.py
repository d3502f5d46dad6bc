"""What the steps towards the configuration `v3` give over `paper`."""
