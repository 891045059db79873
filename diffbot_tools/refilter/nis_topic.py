"""Form of the topic ``/ekf/nis`` of a refiltered bag, for those who write and read it."""

from __future__ import annotations

NIS_TOPIC = "/ekf/nis"
NIS_LABELS = ("nis", "numbers", "accepted")
"""NIS of a measurement, how many numbers were measured, and 1 if it was accepted: labels of a Float64MultiArray"""
