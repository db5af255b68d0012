"""The commands of the command line."""

# The module of each, which is imported once it is called, and its text. The module has a function of the command's name
# (`warm_up` for warm-up), which takes its options, and one that adds its arguments to a parser (`warm_up_arguments`).
COMMANDS = {
    "new": ("new", "write a scene file to begin with"),
    "check": ("scenes", "check a scene file and report what would be computed"),
    "view": ("scenes", "write an interactive page: room, motion, and the paths over time"),
    "materials": ("plot", "list or draw the built-in materials, with sources and uncertainty"),
    "schema": ("new", "print the JSON schema of scene files, for editors"),
    "run": ("run", "render a scene file into a folder of sound files, tables and pictures"),
    "rir": ("scenes", "write the impulse responses of a scene file at one instant"),
    "paths": ("scenes", "list the paths of a scene file"),
    "study": ("study", "render a scene many times with other values of some of its fields"),
    "score": ("results", "report the errors of ranges found in the results of a run"),
    "plot": ("plot", "draw directivities, or the absorption of air"),
    "compare": ("compare", "compare a measured impulse response with that of a scene file"),
    "verify": ("results", "compare the results of a run or a study with their digests and checksums"),
    "validate": ("compare", "simulate measured rooms, and write a page of the differences"),
    "devices": ("devices", "list the OpenCL devices of this machine"),
    "warm-up": ("devices", "build the kernels of common scenes, so that first renders start sooner"),
    "completion": ("completion", "print the script with which a shell completes commands and options"),
}
# Groups of `clsim --help`, by the command that each begins with: a title and an example.
GROUPS = {
    "new": ("scene files", "clsim new scene.toml --mesh hall.obj --trajectory walk.csv"),
    "run": ("sound and paths", "clsim run scene.toml -o out"),
    "score": ("results", "clsim score out"),
    "devices": ("this machine", "clsim devices"),
}
