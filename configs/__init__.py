"""Configuration files and the one strict loader that reads them."""
