"""Plans, checks and times inspection missions for fleets of UAVs."""

__version__ = "0.1.0"
