"""Tests of vrcaps."""
