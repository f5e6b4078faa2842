from .dataset import Dataset as Dataset
from .dataset import Member as Member
from .dataset import open as open
from .sequences import sequences_of as sequences_of
