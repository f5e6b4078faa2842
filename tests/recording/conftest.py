from tests.support.small_episode import *  # noqa: F403
