r"""Cockpit: steer the capsule by magnet from a browser, and save the drive.

A thin layer over the scenario's `Rollout`, which `record` also uses. A drive is therefore recorded
again from its commands alone, to the same bytes. Types on the arrows:

    browser -> Command -> Page -> Operator -> JoystickCommand -> Rollout -> View -> Status -> page
                                      \-> Drive: commands.csv, drive.json -> `vrcaps record`

- `session` contains the simulation. `Session` is its thread: it steps the rollout, paces it by a
  `Clock` and publishes a `View` after each step, without waiting for the page. `Operator` converts
  the driver's input to joystick commands; `Drive` saves them every second; `PolicyDriver` lets a
  policy control the joystick; `CameraImages` renders the camera in another thread.
- `web` contains the page itself: HTML, CSS and JavaScript without libraries. `messages` defines its
  commands and the answers, `connections` its WebSockets, `server` admits requests with a token.
- `page.Page` executes commands and sends values; `driving` contains that of a drive, `episodes`
  that of recorded episodes.
- `scene` contains the nodes of the 3D scene, which the library viser draws in a frame of the page,
  the colorings of the organ, and the viewpoints.
- `bridge` serves a simulated capsule to programs instead of a page.
- `open_cockpit` serves the page; its `Cockpit` runs consecutive drives in the same page.

An error in a page does not stop the simulation: it becomes a message in the page and a
line in the terminal.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
