"""What a camera in the world sees, with exact labels."""
