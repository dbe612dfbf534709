"""A recorded flight once more: with the fates its link had, or through a fresh core bit for bit."""
