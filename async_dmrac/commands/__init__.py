"""Subcommands of `dmrac`, a file each: `add_arguments(parser)` and `run(args)`, which returns the exit status."""
