"""The data to learn from: labels of samples, the buffer, and experience files."""
