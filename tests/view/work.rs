//! Long work on the page in a browser: it is started, watched and cancelled.

use crate::browser::Browser;
use crate::run;
use crate::socket::Server;
use serde_json::json;
use std::time::Duration;

#[test]
fn a_user_trains_cancels_and_splits() {
    let Some(mut browser) = Browser::start() else { return };
    let folder = run();
    let root = folder.path();
    let server = Server::start(root, &[]);
    let tab = browser.visit(&server);
    browser.set(&tab, "fine-steps", "1000000");
    browser.eval(&tab, "document.getElementById('fine-start').click()");
    browser.wait(&tab, "/steps.*left, loss/.test(document.getElementById('job-figures').textContent)");
    browser.wait(&tab, "document.querySelectorAll('#job-loss .line').length === 1");
    browser.wait(&tab, "document.getElementById('job-progress').value > 20");
    browser.eval(&tab, "document.getElementById('job').scrollIntoView({ block: 'end' })");
    browser.shoot(&tab, "4-work");

    // it continues without the tab, and another tab is informed
    browser.call(Some(&tab), "Page.close", json!({}));
    let tab = browser.visit(&server);
    browser.wait(&tab, "/loss/.test(document.getElementById('job-figures').textContent)");
    browser.eval(&tab, "document.getElementById('job-cancel').click()");
    browser.wait(&tab, "document.getElementById('job').dataset.end === 'stopped'");
    assert_eq!(browser.eval(&tab, "document.getElementById('job-cancel').hidden"), true);

    browser.eval(&tab, "document.querySelector('#tree input[type=checkbox]').click()");
    browser.set(&tab, "split-parts", "2");
    browser.eval(&tab, "document.getElementById('split-start').click()");
    browser.wait(&tab, "document.getElementById('job').dataset.end === 'done'");
    browser.wait(&tab, "document.getElementById('tree').textContent.includes('.1')");

    browser.eval(&tab, "[...document.querySelectorAll('#tree input[type=checkbox]')].at(-1).click()");
    browser.set(&tab, "track-times", "4");
    browser.set(&tab, "track-name", "pair");
    browser.eval(&tab, "document.getElementById('track-start').click()");
    browser.wait(&tab, "/^tables and pictures of pair/.test(document.getElementById('job-figures').textContent)");
    browser.set(&tab, "export-times", "3");
    browser.eval(&tab, "document.getElementById('export-start').click()");
    browser.wait(&tab, "/export.frames/.test(document.getElementById('job-figures').textContent)");
    assert!(root.join("run/track/pair/statistics.csv").is_file() && root.join("run/export/frames/0002.ply").is_file());
    browser.eval(&tab, "document.getElementById('job').scrollIntoView({ block: 'end' })");
    browser.shoot(&tab, "4-work-done");

    // finished work is not announced to a window opened later, which can still read about it
    std::thread::sleep(Duration::from_secs(3));
    let later = browser.visit(&server);
    browser.wait(&later, "/^Last, .* ago, export/.test(document.getElementById('job-last').textContent)");
    let said = "[document.getElementById('job').hidden, document.getElementById('job-news').textContent]";
    assert_eq!(browser.eval(&later, said), json!([true, ""]));
    browser.eval(&later, "document.getElementById('masks-start').click()");
    browser.wait(&later, "document.getElementById('job').dataset.end === 'failed'");
    browser.wait(&later, "document.getElementById('job-figures').textContent.includes('tick `replace`')");
    assert_eq!(browser.eval(&later, "document.getElementById('job-last').hidden"), true);
    assert!(browser.wrong.is_empty(), "{:?}", browser.wrong);
}
