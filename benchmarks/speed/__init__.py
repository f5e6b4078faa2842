"""Speed of rendering, recording, physics, data sets and the cockpit; memory and file sizes."""
