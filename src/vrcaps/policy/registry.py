"""All baselines: policies that need no learning."""

BASELINES = {
    "random": "vrcaps.policy.random:RandomPolicy",
    "centerline": "vrcaps.policy.centerline:CenterlinePolicy",
    "look-around": "vrcaps.policy.look_around:LookAroundPolicy",
    "next-best-view": "vrcaps.policy.next_best_view:NextBestViewPolicy",
    "navigator": "vrcaps.policy.navigator:NavigatorPolicy",
}
"""Import path of each by its name."""
