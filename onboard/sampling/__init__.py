"""The signal vector, and the samples that go to the trainer."""
