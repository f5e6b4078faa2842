"""Lumen contents: bubbles, chyme and liquid.

`contents.Contents` says what there is, by severity or by parameters (`bubbles`, `chyme`, `liquid`,
`bowel_preparation`). `lumen_contents` holds it in an organ at one instant: `placement`, `cluster`
and `dome_attachment` place the spheres (`particles`), `pools` finds where liquid stands.
"""
