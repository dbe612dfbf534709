"""A recorded flight once more: with the deliveries its link had, or through a fresh core bit for bit."""
