"""One flight: its scenario, flown in lockstep or in real time, with trace, metrics, summary and figure."""
