"""Formats for detection, segmentation, classification and object poses: COCO, BOP, images."""
