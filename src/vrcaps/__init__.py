"""vrcaps: a virtual environment for capsule endoscopy."""
