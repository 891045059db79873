import { startLive } from "./live.js";
import { page } from "./page.js";
import { startReport } from "./report.js";

// Starts the page: a report contains its data, and a live page connects to `diffbot watch`.

if (page.data.kind === "report") await startReport();
else startLive();
