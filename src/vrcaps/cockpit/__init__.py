r"""Cockpit: steer the capsule by magnet from a browser, and save the drive.

A thin layer over the scenario's `Rollout`, which `record` also uses. A drive is therefore recorded
again from its commands alone, to the same bytes. Types on the arrows:

    page (browser) -> Operator -> JoystickCommand -> Rollout -> View -> panels -> page
                        \-> Drive: commands.csv, drive.json -> `vrcaps record`

- `session` contains the simulation. `Session` is its thread: it steps the rollout, paces it by a
  `Clock` and publishes a `View` after each step, without waiting for the page. `Operator` converts
  the driver's input to joystick commands; `Drive` saves them every second; `PolicyDriver` lets a
  policy control the joystick; `CameraImages` renders the camera in another thread.
- `scene` contains the nodes of the 3D scene and the colorings of the organ.
- `page.Page` is the page in all browsers; its parts are in `panels` and read the simulation only
  through a `View`. `browser` uses private parts of the page's library, `server` admits requests
  with a token.
- `episodes` is the page of recorded episodes.
- `open_cockpit` serves the page; its `Cockpit` runs consecutive drives in the same page.

An error in a page or a panel does not stop the simulation: it becomes a message in the page and a
line in the terminal.

The names in `__init__.pyi` are loaded when they are first used.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
