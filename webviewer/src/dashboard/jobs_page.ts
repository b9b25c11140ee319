/** /jobs: what runs and what ran, and a new job by dropping a level. */
import { h } from "./element";
import { main, openPage, skeleton } from "./frame";
import { JobList } from "./job_list";
import { NewJob } from "./new_job";

const session = await openPage([["/", "filter"], ["↑ ↓", "row"], ["Enter", "open"], ["N", "new job"]]);
const list = new JobList();
const panel = new NewJob(session.scopes.includes("submit"), (page) => location.assign(page));
const loading = skeleton(6);
await list.refresh(); // drawn at once with its rows: nothing below them jumps
loading.stop();
main.replaceChildren(h("div", { class: "jobs" }, list.element, panel.element));
