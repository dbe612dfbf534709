"""Many flights: what a campaign unfolds into, who flies them, where their rows are kept; tuning."""
