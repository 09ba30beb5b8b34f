"""The report: one HTML page with pictures that tells whether, where and how closely a fleet flies clear."""

from missionplanner.report.overview import write_inspection_report
from missionplanner.report.page import write_check_report, write_replay, write_report

__all__ = ["write_check_report", "write_inspection_report", "write_replay", "write_report"]
