"""The command line: which commands there are. Each is a file of its own here, imported when it is called."""

from __future__ import annotations

from hybrid_sysid_ros.commands.program import Commands, LateCommand, run_program

HERE = "hybrid_sysid_ros.commands"
COMMANDS = [
    LateCommand("simulate", f"{HERE}.simulate", "Simulate an experiment on a rig and write its bag."),
    LateCommand("film", f"{HERE}.film", "Simulate an experiment before a camera: its bag and a film."),
    LateCommand("video", f"{HERE}.video", "Read a joint's angle out of a film and write a bag."),
    LateCommand("identify", f"{HERE}.identify", "Identify a model from bags."),
    LateCommand("evaluate", f"{HERE}.evaluate", "Score a model on bags by free run and closed loop."),
    LateCommand("ensemble", f"{HERE}.ensemble", "Score several models together on bags."),
    LateCommand("search", f"{HERE}.search", "Search the options of a structure."),
    LateCommand("trim", f"{HERE}.trim", "Find an equilibrium of a rig and the modes about it."),
    LateCommand("accuracy", f"{HERE}.accuracy", "Tell the accuracy from simulated and live shots."),
    LateCommand("friction", f"{HERE}.friction", "Draw a law of friction, or list them."),
    LateCommand("run", f"{HERE}.run", "Run plant, estimator, controller and reference as ROS 2 nodes."),
    LateCommand("say", f"{HERE}.say", "Say in plain language what the rig is to do."),
    LateCommand("mcp", f"{HERE}.mcp", "Serve checked commands to language models."),
    LateCommand("play", f"{HERE}.play", "Publish the messages of a bag again."),
    LateCommand("replay", f"{HERE}.replay", "Let estimator and controller answer a recorded loop again."),
    LateCommand("parameters", f"{HERE}.parameters", "Write the ROS parameter file of a rig's nodes."),
    LateCommand("check", f"{HERE}.check", "Check the installation in a quarter of a minute."),
    LateCommand("view", f"{HERE}.view", "Show a running rig on a page of this computer."),
    LateCommand("mockup", f"{HERE}.mockup", "From what is known beforehand to a verdict: models, shots, a controller."),
    LateCommand("demo", f"{HERE}.demo", "From bags to a controlled rig: identify, run the loop, report."),
]
POLICY_COMMANDS = [
    LateCommand("train", f"{HERE}.policy_train", "Train a network that imitates the exact MPC."),
    LateCommand("certify", f"{HERE}.policy_certify", "State how a policy does beside the exact MPC, and how surely."),
    LateCommand("export", f"{HERE}.policy_export", "Write a policy as ONNX and as C99."),
]
MODEL_COMMANDS = [
    LateCommand("export", f"{HERE}.model_export", "Write a model as CasADi functions."),
]
RIG_COMMANDS = [
    LateCommand("new", f"{HERE}.rig_new", "Write a small rig to begin with."),
    LateCommand("check", f"{HERE}.rig_check", "Check a rig and show its step response."),
    LateCommand("layouts", f"{HERE}.rig_layouts", "Write a rig's URDF, and layouts for Foxglove and PlotJuggler."),
    LateCommand("list", f"{HERE}.rig_list", "List the rigs that are known by name."),
]


def main() -> None:
    """Run a command of the command line."""
    policy = Commands("policy", POLICY_COMMANDS, help="Approximate MPC.")
    rig = Commands("rig", RIG_COMMANDS, help="Rigs: a folder each.")
    model = Commands("model", MODEL_COMMANDS, help="Models elsewhere.")
    run_program(Commands("hybrid-sysid", [*COMMANDS, model, policy, rig]))
