"""Cameras, their lenses and the rays of their pixels."""
