/* What the pages share on which a person marks something in a capture's photograph: questions to the program. */
"use strict";

const $ = (id) => document.getElementById(id);

/** Function that asks the program: its part of the interface, and what each question contains besides the capture. */
const asker = (part, always = () => ({})) => async (name, body = {}) => {
  const answer = await fetch(`api/${part}/${name}`, {
    method: "POST", headers: { "Content-Type": "application/json" },
    body: JSON.stringify({ capture: $("capture").value, ...always(), ...body }),
  });
  const record = await answer.json();
  if (!answer.ok) throw new Error(record.error);
  return record;
};

/** Run a step; its error is shown at the top of the page. */
async function attempt(step) {
  $("mistake").textContent = $("saved").textContent = "";
  document.body.dataset.busy = "true";
  try {
    await step();
  } catch (error) {
    $("mistake").textContent = error.message;
  }
  document.body.dataset.busy = "false";
}
