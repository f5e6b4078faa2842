"""Bridge: publish a simulated capsule's sensors and accept commands, for clients of rosbridge.

Types on the arrows:

    Rollout -> Step -> RosMessage -> BridgeServer -> JSON -> client
    client -> JSON -> Request -> Commands -> Rollout

- `simulation.LiveSimulation` steps the rollout of a scenario in the calling thread, paced by a
  clock, and publishes the messages of each frame in the layout of `vrcaps export ros2-bag`.
- `server.BridgeServer` serves the clients in a separate thread, so that none slows the simulation;
  `protocol` parses and checks their requests (rosbridge protocol 2.1, as JSON).
- `commands` converts their messages to those of the magnet or the coils, at a simulated time.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
