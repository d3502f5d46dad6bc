"""The interactive viewer: a scene in the browser, drawn by the integer renderer, with the machine's numbers.

    state         what the user has set: camera, gaze, levels, effects, eyes, renderer, overlay
    session       a scene and its quantised model; makes pictures, numbers and splat records of states, without a browser
    pictures      overlays, both eyes in one picture, marks
    numbers       intersections, cycles, energy and frame rate of a frame
    splat         which splat contributes most to a pixel
    worker        threads in which the newest state goes first
    server, window, controls   the viewer in the browser (these need viser)
    command       `msv2 view`
    benchmark     the viewer's frame time beside the renderer's own
    screenshots   pictures of the viewer itself
"""
