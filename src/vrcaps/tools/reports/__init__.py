"""Reports: overview of an organ, coverage of an episode, policy evaluations and data sets."""
