"""Centerline of a lumen: a smoothed minimum-cost path through its distance field."""

from vrcaps.organ.centerline.compute import compute_centerline as compute_centerline
from vrcaps.organ.centerline.compute import reversed_centerline as reversed_centerline
from vrcaps.organ.centerline.curve import centerline_from_points as centerline_from_points
from vrcaps.organ.centerline.curve import interpolate as interpolate
