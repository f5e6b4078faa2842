from small_episode import *  # noqa: F403
