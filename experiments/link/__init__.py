"""What the link may do: dropouts flown by name, transfers across loss, and docs/link.md."""
