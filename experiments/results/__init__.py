"""Results of flown campaigns: statistics, tables, figures and docs/results.md."""
