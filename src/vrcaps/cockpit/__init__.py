r"""Cockpit: drive the capsule by magnet from a browser, and save the drive.

A thin layer over the scenario's `Rollout`, which `record` also uses. A drive is therefore recorded
again from its commands alone, to the same bytes. Types on the arrows:

    page (browser) -> Operator -> JoystickCommand -> Rollout -> View -> panels -> page
                        \-> Drive: commands.csv, drive.json -> `vrcaps record`

- `session.Session` is the simulation thread. It steps the rollout, paces it by a `clock.Clock` and
  publishes a `view.View` after each step. It never blocks on rendering.
- `operator.Operator` converts the driver's input to joystick commands and logs them;
  `drive.Drive` writes them to disk every second.
- `policy_driver.PolicyDriver` lets a policy control the joystick until it hands back.
- `camera_images.CameraImages` renders the images of the capsule's camera in a separate thread, as
  often as time allows.
- `page.Page` is the page in all browsers. Its panels are one small file each in `panels`; they
  know the simulation only through a `View`. `browser` is the only file that uses private parts of
  the page's library. `gate` admits requests with a token.
- The scene consists of nodes (`scene_nodes`, `magnet_node`, `patient_node`), which the page of
  recorded episodes (`episode_page`) shares. `colorings` colors the organ. `pace` updates the
  scene less often if a browser draws slowly.
- `cockpit.open_cockpit` puts all together; its `Cockpit` runs one drive after another in the same
  page, with the changes of `new_drive`.

Errors in a page or a panel do not stop the simulation: they become a message in the page and a
line in the terminal.
"""
