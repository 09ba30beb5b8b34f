"""Optimisers that minimise a batched function over a box and know nothing of UAVs."""

from missionplanner.search.base import Optimiser, SearchResult
from missionplanner.search.registry import algorithms, find_algorithm
from missionplanner.search.run import minimise

__all__ = ["Optimiser", "SearchResult", "algorithms", "find_algorithm", "minimise"]
