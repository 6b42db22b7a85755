// The state of the loop in one word, and the services of its controller. What does nothing in a state is off; Stop acts
// in each of them, for what is shown may be older than what somebody else has just done.

import { element, model } from "./model.js";

const SIGNS = ["driving", "slowed", "holding", "resting", "stopped", "disarmed", "silent"];
const ASKED = /service enable/; // in the reason of a state that somebody has asked for
const LATCHED = /services reset/; // in that of an emergency stop
const AT_REST = ["stopped", "disarmed"];
const UNREACHED = "Stop does not reach the rig from here";
const buttons = [...document.querySelectorAll("#calls button")];
let lost = true;

// What there is to show: a word, which is the sign's name, too, and a reason.
function present() {
  const status = model.statuses.get("controller: loop");
  if (lost) return ["no connection", UNREACHED, "lost"];
  if (!status || !model.controller) return ["waiting", "no controller has said anything yet", "waiting"];
  const { state, reason } = model.controller, { ready } = model.values("controller: loop");
  const unready = state === "disarmed" && ready && ready !== "yes" ? `; not ready: ${ready}` : "";
  const line = state === "driving" || status.line !== "running" ? status.line : "";
  return [state, reason + unready || line, SIGNS.includes(state) ? state : "other"];
}

// Whether a service would change anything.
function isUseful(service, state, reason) {
  if (service === "arm") return state === "disarmed" && !LATCHED.test(reason) && (model.values("controller: loop").ready ?? "yes") === "yes";
  if (service === "disarm") return state !== "disarmed";
  if (service === "hold") return !AT_REST.includes(state) && !(state === "holding" && ASKED.test(reason));
  if (service === "enable") return ["holding", "stopped", "resting", "other"].includes(state);
  return true;
}

export function tellOperation() {
  const [state, reason, sign] = present(), box = element("state");
  if (box.dataset.sign !== sign) {
    box.dataset.sign = sign;
    box.querySelector("use").setAttribute("href", `#sign-${sign}`);
  }
  tell("state-word", state);
  tell("state-reason", reason);
  element("state-reason").title = reason;
  document.title = model.rig ? `${state} – ${model.rig.rig}` : "live view";
  for (const button of buttons) {
    const { service } = button.dataset, there = !lost && model.there.services.includes(service);
    const always = service === "stop" || service === "estop";
    button.hidden = ["arm", "disarm", "estop"].includes(service) && !there;
    button.disabled = !(there && (always || isUseful(service, sign === "other" ? sign : state, reason)));
  }
  element("stop").classList.toggle("quiet", AT_REST.includes(state));
}

// A text that is announced when it changes, and only then.
function tell(id, text) {
  if (element(id).textContent !== text) element(id).textContent = text;
}

export function tellLost(isLost) {
  lost = isLost;
  tellOperation();
}

export function buildOperation(ask) {
  for (const button of buttons) button.addEventListener("click", () => ask({ do: "call", service: button.dataset.service }));
  const escape = (event) => event.key === "Escape" && !event.repeat && ask({ do: "call", service: "stop" });
  addEventListener("keydown", escape, { capture: true });
}
