from .cockpit import Cockpit as Cockpit
from .cockpit import open_cockpit as open_cockpit
from .episode_page import EpisodePage as EpisodePage
from .episode_page import open_episodes as open_episodes
from .server import Gate as Gate
from .session.drive import cockpit_scenario as cockpit_scenario
from .session.session import Session as Session
