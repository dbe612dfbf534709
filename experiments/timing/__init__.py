"""How long an onboard step takes, block by block."""
