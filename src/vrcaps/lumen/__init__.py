"""Lumen contents: bubbles, chyme and liquid.

`contents.Contents` sets the contents by severity or by parameters (`bubbles`, `chyme`, `liquid`,
`bowel_preparation`). `lumen_contents` holds the contents of an organ at one instant: `placement`,
`cluster` and `dome_attachment` place the spheres (`particles`), `pools` locates standing liquid.
"""
