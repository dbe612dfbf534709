"""The learning process: collects samples, trains the inner layers with torch and sends them back."""
