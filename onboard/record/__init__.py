"""What is logged of each tick: the tick record and the core's inputs and outputs."""
