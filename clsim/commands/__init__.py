"""The commands of the command line, a file each."""

# Each is a module of `clsim.commands` (`warm_up` for warm-up) that has `add_arguments(parser)` and `execute(options)`,
# imported once it is called.
COMMANDS = {
    "new": "write a scene file to begin with",
    "check": "check a scene file and report what would be computed",
    "view": "write an interactive page: room, motion, and the paths over time",
    "materials": "list or draw the built-in materials, with sources and uncertainty",
    "schema": "print the JSON schema of scene files, for editors",
    "run": "render a scene file into a folder of sound files, tables and pictures",
    "rir": "write the impulse responses of a scene file at one instant",
    "paths": "list the paths of a scene file",
    "study": "render a scene many times with other values of some of its fields",
    "score": "report the errors of ranges found in the results of a run",
    "plot": "draw directivities, or the absorption of air",
    "compare": "compare a measured impulse response with that of a scene file",
    "verify": "compare the results of a run or a study with their digests and checksums",
    "validate": "simulate measured rooms, and write a page of the differences",
    "devices": "list the OpenCL devices of this machine",
    "warm-up": "build the kernels of common scenes, so that first renders start sooner",
    "completion": "print the script with which a shell completes commands and options",
}
# Groups of `clsim --help`, by the command that each begins with: a title and an example.
GROUPS = {
    "new": ("scene files", "clsim new scene.toml --mesh hall.obj --trajectory walk.csv"),
    "run": ("sound and paths", "clsim run scene.toml -o out"),
    "score": ("results", "clsim score out"),
    "devices": ("this machine", "clsim devices"),
}
