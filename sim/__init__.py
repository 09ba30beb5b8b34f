"""Simulated vehicles that stand in for autopilots and speak MAVLink to any ground station."""
