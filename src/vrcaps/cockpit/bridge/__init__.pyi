from .simulation import LiveSimulation as LiveSimulation
from .simulation import open_bridge as open_bridge
