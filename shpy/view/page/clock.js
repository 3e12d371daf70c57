// The clock of a view: buttons that play, step and reset, and what they do, for keys as well.

import { at } from "./elements.js";

export function clockOf(connection, state, change) {
  const actions = {
    play: () => change({ playing: !state.playing }),
    step: () => { if (state.playing) change({ playing: false }); setTimeout(() => connection.send({ do: "step" }), 30); },
    reset: () => connection.send({ do: "reset" }),
  };
  for (const [name, action] of Object.entries(actions)) at(name).onclick = action;
  return actions;
}
