"""Long real-time flights in which processes are stopped, killed and started again and ports are flooded."""
