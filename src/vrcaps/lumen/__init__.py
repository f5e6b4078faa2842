"""What floats in the lumen: bubbles, chyme and liquid."""
