"""What earlier flights taught: conditions with a last layer each, shared inner layers, and the file that holds them."""
