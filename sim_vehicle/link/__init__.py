"""The simulated wires: MAVLink to onboard, and the radio between onboard and offboard."""
