"""The link between onboard and offboard: messages, their bytes, transfer of feature sets, statistics. No I/O."""
