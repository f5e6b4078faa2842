from .dataset import Dataset as Dataset
from .dataset import Member as Member
from .dataset import open as open
from .frame_stream import FrameStream as FrameStream
from .frame_windows import FrameWindows as FrameWindows
from .sequences import sequences_of as sequences_of
