"""Registry of baselines: policies without training."""

BASELINES = {
    "random": "vrcaps.policy.random:RandomPolicy",
    "centerline": "vrcaps.policy.centerline:CenterlinePolicy",
    "look-around": "vrcaps.policy.look_around:LookAroundPolicy",
    "next-best-view": "vrcaps.policy.next_best_view:NextBestViewPolicy",
    "navigator": "vrcaps.policy.navigator:NavigatorPolicy",
}
"""Import path of each baseline by its name."""
