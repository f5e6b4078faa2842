"""Offline tools: organs from CT, mucosae from photographs, camera calibration, overviews."""
