r"""The cockpit: drive the capsule by magnet from a browser, and keep what was driven.

A thin layer over the scenario's `Rollout`, which is what `record` walks through, too. So what was
driven is recorded again from the commands alone, to the same bytes. Types on the arrows:

    page (browser) -> Operator -> JoystickCommand -> Rollout -> View -> panels -> page
                        \-> Drive: commands.csv, drive.json -> `vrcaps record`

- `session.Session` is the simulation thread. It steps the rollout, paces it by a `clock.Clock` and
  leaves a `view.View` after each step. It waits for nobody.
- `operator.Operator` makes joystick commands of what the driver does, and is their log;
  `drive.Drive` keeps them on disk, each second.
- `policy_driver.PolicyDriver` is a policy at the joystick, until it hands back.
- `camera_images.CameraImages` renders what the capsule's camera sees, in a thread of its own, as
  often as there is time.
- `page.Page` is the page in all browsers. Its panels are one small file each in `panels`; what they
  do with a `View` is all that they know of the simulation. `browser` is the only file that knows
  private parts of the page's library, `gate` lets in those with a token.
- The scene is made of nodes (`scene_nodes`, `magnet_node`, `patient_node`), which the page of
  recorded episodes (`episode_page`) shows, too; `colorings` has what the organ is colored by.
  `pace` sends it less often where a browser draws slowly.
- `cockpit.open_cockpit` puts all together; its `Cockpit` begins one drive after another in the same
  page, with what `new_drive` changes.

Nothing that goes wrong in a page or a panel stops the simulation: it becomes a message in the page
and a line in the terminal.
"""
