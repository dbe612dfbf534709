"""Campaigns: their flights, the workers that fly them, and the stored rows; tuning."""
