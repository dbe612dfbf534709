"""One flight: its scenario, flown in lockstep or in real time, its trace, metrics, card and picture."""
