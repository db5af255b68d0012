"""The commands of the command line, a file each."""

# Each is a module of `clsim.commands` (`warm_up` for warm-up) that has `add_arguments(parser)` and `execute(options)`,
# imported once it is called.
COMMANDS = {
    "new": "write a scene file to begin with",
    "run": "render a scene file into a folder of sound files, tables and pictures",
    "check": "check a scene file and say what would be computed",
    "paths": "list the paths of a scene file",
    "rir": "write the impulse responses of a scene file at one instant",
    "view": "write an interactive page: room, motion, and the paths over time",
    "plot": "draw directivities, or what air absorbs",
    "materials": "list or draw the built-in materials, with sources and uncertainty",
    "score": "tell how well ranges are found in the results of a run",
    "validate": "simulate rooms that were measured, and write a page of how far that is from the measurement",
    "compare": "compare a measured impulse response with that of a scene file",
    "verify": "compare the results of a run or a study with the digests and checksums of what was written",
    "study": "render a scene many times with other values of some of its fields",
    "devices": "list the OpenCL devices of this machine",
    "warm-up": "build the kernels that common scenes need, so that first renders need not",
    "schema": "print the JSON schema of scene files, for editors",
    "completion": "print what makes a shell complete commands and options",
}
