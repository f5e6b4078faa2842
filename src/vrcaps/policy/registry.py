"""All baselines: policies that need no learning."""

BASELINES = {
    "random": "vrcaps.policy.random:RandomPolicy",
}
"""Import path of each by its name."""
